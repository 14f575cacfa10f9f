"""The same as ``binpick example``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["example", *sys.argv[1:]]))
