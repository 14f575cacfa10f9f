"""The same as ``binpick compare``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["compare", *sys.argv[1:]]))
