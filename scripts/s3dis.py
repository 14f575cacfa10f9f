"""The same as ``binpick s3dis``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["s3dis", *sys.argv[1:]]))
