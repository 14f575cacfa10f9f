"""The same as ``binpick pick``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["pick", *sys.argv[1:]]))
