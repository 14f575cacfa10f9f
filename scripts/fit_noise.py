"""The same as ``binpick fit-noise``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["fit-noise", *sys.argv[1:]]))
