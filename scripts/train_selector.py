"""The same as ``binpick train-selector``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["train-selector", *sys.argv[1:]]))
