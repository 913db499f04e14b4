"""`python -m jaxshell` is the command `jaxshell`."""

import sys

from jaxshell.command.cli import main

sys.exit(main())
