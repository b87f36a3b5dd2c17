import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.robot import RobotModel, load_robot

ROOT = Path(__file__).resolve().parents[3]
FULL = ROOT.parent / "shared" / "data"
EXCERPTS = ROOT / "test" / "data" / "recordings"


@pytest.fixture(scope="session")
def panda():
    return RobotModel(load_robot(ROOT / "config" / "robots" / "panda.yaml"))


@pytest.fixture(scope="session")
def recording_path():
    """Find a recording: the whole one beside the repository, else the excerpt in test/data, else skip."""
    def find(folder, name):
        for root in (FULL, EXCERPTS):
            if (root / folder / name).exists():
                return root / folder / name
        pytest.skip(f"recording {folder}/{name} is neither in ../shared/data nor in test/data/recordings")
    return find


@pytest.fixture(scope="session")
def recording(recording_path):
    """Load an npz recording as a dictionary of arrays."""
    def load(folder, name):
        with np.load(recording_path(folder, name)) as file:
            return dict(file)
    return load


@pytest.fixture(scope="session")
def figures():
    """Load the benchmark whose figures are held here, so that what it prints is what is tested."""
    spec = importlib.util.spec_from_file_location("capture_recordings", ROOT / "benchmarks" / "capture_recordings.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
