"""PPO and ICM curiosity on any ML-Agents environment, with Stable-Baselines3.

A step goes from a player (``players``: communicator, environment, ``gym_wrapper`` or ``vec_env``) through what learns
(``learning``: monitor, normaliser, curiosity, PPO) into a run's folder (``runs``). ``commands`` is what a user types.
"""

import os

# For products this small a second BLAS thread only fights the player, or another run, for its core. NumPy reads this
# when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from trainer import mlagents_compat

mlagents_compat.install()
