"""The same as ``binpick evaluate-bin``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["evaluate-bin", *sys.argv[1:]]))
