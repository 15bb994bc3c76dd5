"""How the packages of engines are imported."""

import subprocess
import sys

import pytest

from impact_xval.compliant_baselines.engines.packages import standing_in

CODE = """
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from impact_xval.compliant_baselines.engines import packages

if len(sys.argv) > 1:
    os.close(2)
else:
    os.write(2, b"before;")
importing = packages.import_module
packages.import_module = lambda name: (importing(name), len(sys.argv) > 1 or os.write(2, b"meanwhile;"))[0]
with ThreadPoolExecutor(4) as pool:
    first, *others = pool.map(lambda _: packages.import_pybullet(), range(4))
assert all(other is first for other in others)
print("after", file=sys.stderr if len(sys.argv) == 1 else sys.stdout)
"""


def test_pybullet_is_imported_without_a_word_and_nobody_else_is_silenced():
    pytest.importorskip("pybullet")
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "before;" + 4 * "meanwhile;" + "after\n")


def test_pybullet_is_imported_where_standard_error_is_closed():
    pytest.importorskip("pybullet")
    done = subprocess.run([sys.executable, "-c", CODE, "closed"], capture_output=True, text=True, check=True)
    assert done.stdout == "after\n"


def test_a_stand_in_is_gone_afterwards_whatever_happens():
    import colorsys

    substitute = object()

    def fail():
        with standing_in("colorsys", substitute):
            assert sys.modules["colorsys"] is substitute
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert sys.modules["colorsys"] is colorsys
