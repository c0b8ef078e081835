"""Keep other libraries' chatter off standard error."""

from __future__ import annotations

import logging
import warnings


def quiet_libraries() -> None:
    """Silence progress bars and informational messages of the libraries that a command uses.

    Errors still surface: only messages below ERROR of named libraries, and the bars of ``datasets``, go.
    """
    import datasets

    datasets.disable_progress_bars()
    for name in ("datasets", "lerobot", "torchcodec", "matplotlib", "robosuite"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # lerobot logs through the root logger, which prints warnings when nothing is configured.
    logging.getLogger().addHandler(logging.NullHandler())
    warnings.filterwarnings("ignore", module="torchcodec|lerobot|datasets")
    # joblib's idle workers end after five minutes; while another is still at work, it takes that for a leak.
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given", category=UserWarning)
