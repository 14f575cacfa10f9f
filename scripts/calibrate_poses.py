"""The same as ``binpick calibrate-poses``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["calibrate-poses", *sys.argv[1:]]))
