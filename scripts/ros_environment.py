"""Make a virtual environment's Python find the ROS packages inside it; run by a .pth file at every start.

ROS looks for packages in AMENT_PREFIX_PATH and the loader for libraries in LD_LIBRARY_PATH. The loader reads its
variable only when a process starts, so Python is started once more where it was missing.
"""

import os
import sys

GUARD = "_UNIFEED_ENVIRONMENT"


def _appended(name: str, folder: str) -> str:
    """Append a folder to a variable's list unless it is there."""
    folders = [f for f in os.environ.get(name, "").split(os.pathsep) if f]
    return os.pathsep.join(folders if folder in folders else [*folders, folder])


def activate() -> None:
    """Set both variables, and start Python again if its libraries would not be found."""
    os.environ["AMENT_PREFIX_PATH"] = _appended("AMENT_PREFIX_PATH", sys.prefix)
    libraries = _appended("LD_LIBRARY_PATH", os.path.join(sys.prefix, "lib"))  # noqa: PTH118 (pathlib is slow here)
    if libraries == os.environ.get("LD_LIBRARY_PATH") or os.environ.get(GUARD) == sys.prefix:
        return
    os.environ["LD_LIBRARY_PATH"], os.environ[GUARD] = libraries, sys.prefix
    os.execv(sys.executable, sys.orig_argv)


activate()
