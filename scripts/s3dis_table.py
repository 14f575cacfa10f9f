"""The same as ``binpick s3dis-table``."""

import sys

from policies.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["s3dis-table", *sys.argv[1:]]))
