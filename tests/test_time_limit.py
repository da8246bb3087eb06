"""Every test has a time limit: hangs in Python, compiled code or a child process end, and their stack is printed."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIMIT_S = 1.0
HANGS = {
    "in Python": """
        while True:
            pass
    """,
    "in compiled code": """
        import numba

        @numba.njit("i8(i8)", nogil=True)
        def turns(count):
            while count > 0:
                count = 3 * count + 1 if count % 2 else count // 2
            return count

        turns(1)
    """,
    "waiting for a process": """
        import subprocess, sys

        subprocess.run([sys.executable, "-c", "import time; time.sleep(20)"], timeout=20)
    """,
}


@pytest.mark.slow
@pytest.mark.parametrize(("where", "workers"), [
    (["in compiled code"], 0), (["in Python", "waiting for a process"], 1),
])  # fmt: skip
def test_a_test_that_hangs_ends_with_its_stack(where, workers, tmp_path):
    file = tmp_path / "test_hanging.py"
    hanging = [f"def test_hangs_{n}():" + HANGS[kind].replace("\n    ", "\n") for n, kind in enumerate(where)]
    file.write_text("\n\n".join([*hanging, "def test_goes_on():\n    pass\n"]))
    shutil.copy(ROOT / "tests" / "worker_stacks.py", tmp_path / "conftest.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, "-n", str(workers),
         "-o", f"timeout={LIMIT_S}", "-p", "no:cacheprovider", file],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 1
    assert "Timeout" in said
    assert all(f"in test_hangs_{number}" in said for number in range(len(where))), said
    if workers:
        assert "2 failed, 1 passed" in said  # the worker is replaced, and the other tests are run
