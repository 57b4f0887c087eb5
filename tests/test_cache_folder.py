"""The folder that stands in for a cache that cannot be written."""

import subprocess
import sys

import pytest

_USE = """
import os, sys
from pearl_marl.cache import cache_folder
folder = cache_folder("kernels")
child = os.fork()
if not child:
    sys.exit()
os.waitpid(child, 0)
assert folder.is_dir()
print(folder)
"""


@pytest.mark.parametrize("cache", ["/dev/null/cache", "~nobody_of_that_name/cache"])
def test_a_forked_child_leaves_the_temporary_folder_to_its_parent(cache: str) -> None:
    command = ["env", f"PEARL_CACHE_DIR={cache}", sys.executable, "-c", _USE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "pearl_marl_kernels_" in done.stdout
