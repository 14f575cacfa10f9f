"""The same as ``binpick bench``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["bench", *sys.argv[1:]]))
