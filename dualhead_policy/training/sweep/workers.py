"""Where the groups of a sweep train: processes of this machine, or a cluster through joblib's backends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from joblib import parallel_config

from dualhead_envs.worker_processes import end_with

#: Backends that ``dualhead sweep --backend`` takes.
BACKENDS = ("local", "dask", "ray")
#: Seconds within which a cluster's scheduler must answer.
CONNECT_SECONDS = 10.0


@contextmanager
def workers(backend: str, address: str | None) -> Iterator[None]:
    """A context in which ``joblib.Parallel`` trains where ``backend`` says.

    The workers of a cluster see the same files under the same paths, and have this package installed.

    Args:
        backend: ``"local"``, ``"dask"`` or ``"ray"``.
        address: The cluster's scheduler, for example ``tcp://host:8786`` (Dask) or ``host:6379`` (Ray).

    Raises:
        ValueError: If there is no such backend, or it lacks an address.
        ModuleNotFoundError: If the backend is not installed.
        ConnectionError: If nobody answers at the address.
    """
    if backend not in BACKENDS:
        raise ValueError(f"--backend {backend} is not one of {list(BACKENDS)}: choose one of these")
    if backend == "local":
        if address is not None:
            raise ValueError(f"--address {address} needs a cluster: add --backend dask or --backend ray")
        # The workers of a cluster are ended by its own scheduler.
        with parallel_config(backend="loky", initializer=end_with, initargs=(os.getpid(),)):
            yield
        return
    if address is None:
        raise ValueError(f"--backend {backend} needs its scheduler: give --address")
    try:
        with _dask(address) if backend == "dask" else _ray(address), parallel_config(backend=backend):
            yield
    except ModuleNotFoundError as error:
        if error.name not in ("distributed", "ray"):
            raise
        raise ValueError(
            f"--backend {backend} needs the package {error.name}, which is not installed: install "
            f"lerobot_policy_dualhead[{backend}]"
        ) from error


@contextmanager
def _dask(address: str) -> Iterator[None]:
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise _unreachable("Dask scheduler", address, error) from error
    with client:
        yield


@contextmanager
def _ray(address: str) -> Iterator[None]:
    import ray
    from ray.util.joblib import register_ray

    try:
        ray.init(address=address, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise _unreachable("Ray cluster", address, error) from error
    register_ray()
    try:
        yield
    finally:
        ray.shutdown()


def _unreachable(what: str, address: str, error: Exception) -> ConnectionError:
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return ConnectionError(
        f"no {what} answers at {address} ({reason}): start it, or correct --address; finished runs are untouched"
    )
