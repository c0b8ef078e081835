"""Streams of labels of two heads with known coordination, for tests of the certificate."""

import numpy as np


def stream(decisions=2000, n=4, couple=0.0, prior=0.5, invalid=0.0, flip=False, seed=0, k=2):
    rng = np.random.default_rng(seed)
    probabilities = [prior, 1 - prior] if k == 2 else np.full(k, 1 / k)
    draw = lambda: rng.choice(k, p=probabilities, size=(decisions, n))  # noqa: E731
    a = draw()
    b = np.where(rng.random(a.shape) < couple, (a + flip) % k, draw())
    return tuple(np.where(rng.random(a.shape) < invalid, -1, x) for x in (a, b))
