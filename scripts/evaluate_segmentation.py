"""The same as ``binpick evaluate-segmentation``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["evaluate-segmentation", *sys.argv[1:]]))
