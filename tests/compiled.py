"""The trainer's compiled kernels, called once: Numba takes half a second in every process that begins without it."""

import numpy as np

from trainer.learning import kernels

_one, _number = np.zeros((1, 1), np.float32), np.float32(1)
kernels.add_bias_tanh(_one, _one[0])
kernels.to_before_tanh(_one, _one.copy(), _one[0].copy())
kernels.add_bias_swish(_one, _one[0], _one.copy())
kernels.to_before_swish(_one, _one.copy(), _one[0].copy())
kernels.adam_step(*(np.zeros(1, np.float32) for _ in range(5)), *[_number] * 6)
