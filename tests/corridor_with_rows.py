"""``corridor``, whose runs write a row of progress.csv every 500 steps, not 10,000: short ones have some, too."""

import sys

from trainer.main import main
from trainer.runs import callbacks

callbacks.ROW_STEPS = 500
sys.exit(main())
