"""The same as ``binpick picture``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["picture", *sys.argv[1:]]))
