"""The same as ``binpick check-fast``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["check-fast", *sys.argv[1:]]))
