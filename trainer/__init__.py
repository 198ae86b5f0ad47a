"""PPO and ICM curiosity on any ML-Agents environment, with Stable-Baselines3.

The data flows one way: ``communicator`` -> ``unity`` -> ``gym_wrapper`` or ``vec_env`` -> normalisation ->
``curiosity`` -> PPO (``training``) -> ``results`` and ``figures``.
"""

import os

# For products this small a second BLAS thread only fights the player, or another run, for its core. NumPy reads this
# when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from trainer import mlagents_compat

mlagents_compat.install()
