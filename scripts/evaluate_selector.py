"""The same as ``binpick evaluate-selector``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["evaluate-selector", *sys.argv[1:]]))
