"""The same as ``binpick generate-scenes``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["generate-scenes", *sys.argv[1:]]))
