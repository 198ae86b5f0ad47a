"""PPO and ICM curiosity on any ML-Agents environment, with Stable-Baselines3.

The data flows one way: ``communicator`` -> ``unity`` -> ``gym_wrapper`` or ``vec_env`` -> normalisation ->
``curiosity`` -> PPO (``training``) -> ``results`` and ``figures``.
"""

from trainer import mlagents_compat

mlagents_compat.install()
