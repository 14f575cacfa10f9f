"""The same as ``binpick train-segmentation``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["train-segmentation", *sys.argv[1:]]))
