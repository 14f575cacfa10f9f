"""The same as ``binpick segment``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["segment", *sys.argv[1:]]))
