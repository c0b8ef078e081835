"""Files of a policy's folder, which may be somebody else's: nothing outside it is opened in its name."""

from __future__ import annotations

from pathlib import Path

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


def _is_cached(folder: Path, target: Path) -> bool:
    """Whether a download's cache is meant, whose ``snapshots/REVISION`` holds links into ``blobs`` beside it."""
    return folder.parent.name == "snapshots" and target.is_relative_to(folder.parent.parent / "blobs")
