"""The same as ``binpick assess``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["assess", *sys.argv[1:]]))
