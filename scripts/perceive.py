"""The same as ``binpick perceive``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["perceive", *sys.argv[1:]]))
