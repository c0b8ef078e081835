"""Files of a policy's folder, which may be somebody else's: nothing outside it is opened in its name."""

from __future__ import annotations

import re
from pathlib import Path

#: What a repository on a hub is called: its owner and its name.
_REPOSITORY = re.compile(r"[\w][\w.-]{0,95}/[\w][\w.-]{0,95}")
#: Files of a policy, as they are called on a hub: no pickle, no code.
POLICY_FILES = ("*.json", "model.safetensors", "policy_*.safetensors")
#: Files of the processors, as they are called on a hub.
PROCESSOR_FILES = ("config.json", "policy_preprocessor*", "policy_postprocessor*")


def file_inside(folder: Path, name: str) -> Path:
    """The path of a file of a policy's folder.

    Args:
        folder: The folder.
        name: The file's name; whoever wrote the folder may have chosen it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the name or a link leaves the folder.
    """
    folder = folder.resolve()
    path = folder / name
    if Path(name).name != name or name in ("", ".", ".."):
        raise ValueError(
            f"{folder} names a file outside itself, expected the name of a file beside config.json: do not use this "
            "folder, or ask whoever made it for a whole one"
        )
    target = path.resolve()
    if not target.is_relative_to(folder) and not _is_cached(folder, target):
        raise ValueError(
            f"{path} is a link that leaves its folder, expected a file: copy the file itself into the folder"
        )
    if not target.is_file():
        raise FileNotFoundError(f"{path} is missing: copy the policy's whole folder again")
    return path


def processor_folder(path: str | Path, revision: str | None = None) -> Path:
    """The folder that holds a policy's processors: ``path`` itself, or what a hub's repository of this name holds."""
    if Path(path).is_dir():
        return Path(path).resolve()
    from huggingface_hub import snapshot_download

    return Path(snapshot_download(str(path), revision=revision, allow_patterns=list(PROCESSOR_FILES)))


def downloaded_folder(repository: str | Path) -> Path | None:
    """The folder into which a hub's repository of this name was downloaded; None if it is no such name.

    Raises:
        FileNotFoundError: If the hub has no such repository, or cannot be reached and nothing was downloaded before.
    """
    if not _REPOSITORY.fullmatch(str(repository)):
        return None
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(str(repository), allow_patterns=list(POLICY_FILES)))
    except Exception as error:  # the hub's client raises what its transport does
        raise FileNotFoundError(
            f"{repository} is neither a folder here nor a policy on the hub ({type(error).__name__}): check the "
            "name, and that the hub can be reached"
        ) from error


def _is_cached(folder: Path, target: Path) -> bool:
    """Whether a download's cache is meant, whose ``snapshots/REVISION`` holds links into ``blobs`` beside it."""
    return folder.parent.name == "snapshots" and target.is_relative_to(folder.parent.parent / "blobs")
