"""The same as ``binpick evaluate-pose``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["evaluate-pose", *sys.argv[1:]]))
