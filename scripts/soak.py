"""The same as ``binpick soak``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["soak", *sys.argv[1:]]))
