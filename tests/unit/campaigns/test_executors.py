from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.service.campaigns.archive import files_of
from mavcal.service.campaigns.executors import workers


class Ours(ThreadPoolExecutor):
    over = 0

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        Ours.over += 1
        super().shutdown(wait, cancel_futures=cancel_futures)


def ours() -> Executor:
    return Ours(3)


def nothing() -> str:
    return ""


def test_threads_by_number_and_any_executor_by_its_factory() -> None:
    with workers("threads:3") as given:
        assert given.at_once == 6
        assert given.executor.submit(sum, (1, 2)).result() == 3
    with workers(f"{__name__}:ours") as given:
        assert (type(given.executor).__name__, given.at_once) == ("Ours", 6)
    with pytest.raises(RuntimeError, match="shutdown"):
        given.executor.submit(sum, (1, 2))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("threads:0", "from 1 to 64"),
        ("processes:many", "from 1 to 64"),
        ("forks", "names no executor"),
        ("no.such.module:made", "cannot be loaded"),
        (f"{__name__}:unknown", "cannot be loaded"),
        (f"{__name__}:nothing", "makes a str, which is no Executor"),
    ],
)
def test_what_names_no_executor_is_refused_with_the_forms(text: str, why: str) -> None:
    with pytest.raises(InvalidInputError, match=why), workers(text):
        pass


def test_files_below_a_folder_by_name_without_hidden_ones(tmp_path: Path) -> None:
    for name in ("b.bin", "a/c.bin", "a/d.csv", ".git/e.bin", ".f.bin"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    assert files_of(tmp_path, "*.bin") == ["a/c.bin", "b.bin"]
    assert files_of(tmp_path, "*") == ["a/c.bin", "a/d.csv", "b.bin"]
    with pytest.raises(InvalidInputError, match=r"no file like \*.ulg"):
        files_of(tmp_path, "*.ulg")
    with pytest.raises(InvalidInputError, match="no folder"):
        files_of(tmp_path / "none", "*")
