"""``python -m ringwear_par`` is the ``ringwear`` command."""

import sys

from ringwear_par.cli import main

sys.exit(main())
