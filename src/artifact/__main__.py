"""``python -m artifact``."""

import sys

from artifact.commands.cli import main

sys.exit(main())
