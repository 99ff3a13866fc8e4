"""Run the `cushion` command as `python -m audioflinger_hook`."""

import sys

from audioflinger_hook.cli import main

if __name__ == "__main__":
    sys.exit(main())
