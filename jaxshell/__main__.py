"""`python -m jaxshell` is the command `jaxshell`."""

import sys

from jaxshell.cli import main

sys.exit(main())
