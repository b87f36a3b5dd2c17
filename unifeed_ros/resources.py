"""Where the configuration files are: in the source tree, below pip's prefix or in colcon's share folder."""

from __future__ import annotations

from pathlib import Path

from unifeed_ros.core.errors import ConfigError

PACKAGE = "unifeed_ros"


def share_folder() -> Path:
    """Find the folder that holds config/, launch/ and msg_docs/.

    The folders above this file are searched: the first is the source tree (also behind an editable or a symlinked
    install), the later ones are prefixes with share/unifeed_ros.

    Returns:
        The folder.

    Raises:
        ConfigError: The package was installed without its files.
    """
    for folder in Path(__file__).resolve().parents:
        if (folder / "package.xml").is_file() and (folder / "config").is_dir():
            return folder
        installed = folder / "share" / PACKAGE
        if (installed / "config").is_dir():
            return installed
    raise ConfigError(f"configuration files of {PACKAGE}", expected="config/ beside the package or in share/",
                      got="neither", mend="install again with `make setup` or `colcon build`")


def config_names(kind: str) -> tuple[str, ...]:
    """List the configuration files of a kind.

    Args:
        kind: Folder below config/: "robots", "tasks", or "" for config/ itself.

    Returns:
        Their names without ".yaml", sorted.
    """
    return tuple(sorted(path.stem for path in (share_folder() / "config" / kind).glob("*.yaml")))


def config_path(kind: str, name: str) -> Path:
    """Find one configuration file.

    Args:
        kind: Folder below config/: "robots", "tasks", or "" for config/ itself.
        name: Name of a file there without ".yaml", or the path of a file of one's own, ending in ".yaml".

    Returns:
        The file.

    Raises:
        ConfigError: No such name, or no such file.
    """
    if name.endswith(".yaml"):
        own = Path(name).expanduser()
        if not own.is_file():
            raise ConfigError("configuration file", expected="an existing file", got=name)
        return own
    names = config_names(kind)
    if name not in names:
        what = f"unknown {kind.removesuffix('s')}" if kind else "unknown configuration"
        raise ConfigError(what, expected=f"one of {', '.join(names)}, or a path to a .yaml file", got=name or "nothing")
    return share_folder() / "config" / kind / f"{name}.yaml"
