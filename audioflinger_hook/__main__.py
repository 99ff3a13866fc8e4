"""`python -m audioflinger_hook` is the `cushion` command."""

import sys

from audioflinger_hook.cli import main

if __name__ == "__main__":
    sys.exit(main())
