"""Opens the executor that computes an archive, by its name: any ``concurrent.futures.Executor``."""

from __future__ import annotations

import importlib
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.service.campaigns import worker

FORMS = "threads[:N], processes[:N], dask:ADDRESS or MODULE:FACTORY"
SPARE = 2
"""Orders handed out to each worker at a time, so that it has the next one while an answer is on its way."""


@dataclass(frozen=True)
class Workers:
    """An executor, and how many orders it is given at a time."""

    executor: Executor
    at_once: int


@contextmanager
def workers(text: str) -> Iterator[Workers]:
    """The executor that `text` names (:data:`FORMS`), until the context ends; an error in it ends what is under way.

    Threads wait for child processes, so N of them use N processors. A pool of processes adds nothing to that on one
    machine. A factory is called without arguments and returns an Executor.

    Raises
    ------
    InvalidInputError
        If `text` names none, or it cannot be loaded.
    """
    name, _, rest = text.partition(":")
    if name in {"threads", "processes"}:
        count = _count(text, rest)
        executor: Executor = ThreadPoolExecutor(count, thread_name_prefix="archive")
        if name == "processes":
            executor = _processes(count)
        yield from _until_done(executor, count)
    elif name == "dask":
        yield from _dask(rest)
    elif rest:
        executor = _made(name, rest)
        yield from _until_done(executor, getattr(executor, "_max_workers", None) or os.cpu_count() or 1)
    else:
        raise InvalidInputError(f"{text!r} names no executor: give {FORMS}")


def _processes(count: int) -> Executor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, initializer=worker.with_parent, initargs=(os.getpid(),))


def _until_done(executor: Executor, count: int) -> Iterator[Workers]:
    try:
        yield Workers(executor, SPARE * count)
    except BaseException:  # stopped or cancelled: nobody wants what is under way any more
        abandon()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        worker.stop()


def abandon() -> None:
    """Stop the computations on this machine, whose results nobody awaits any more."""
    worker.stop()
    for process in multiprocessing.active_children():
        process.terminate()


def _dask(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError:
        raise InvalidInputError("dask is not installed: install mavcal[dask]") from None
    try:
        client: Any = Client(address, set_as_default=False, timeout=10)
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"there is no dask scheduler at {address}: {error}") from error
    try:
        cores = sum(client.ncores().values())
        if cores == 0:
            raise InvalidInputError(f"the dask scheduler at {address} has no worker: start some")
        yield Workers(client.get_executor(pure=False), SPARE * cores)
    finally:
        client.close()


def _made(module: str, factory: str) -> Executor:
    try:
        made = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError) as error:
        raise InvalidInputError(f"{module}:{factory} cannot be loaded: {error}. Give {FORMS}") from error
    executor = made()
    if not isinstance(executor, Executor):
        raise InvalidInputError(f"{module}:{factory} makes a {type(executor).__name__}, which is no Executor")
    return executor


def _count(text: str, number: str) -> int:
    if not number:
        return os.cpu_count() or 1
    if not number.isdecimal() or not 1 <= int(number) <= worker.MOST_CHILDREN:
        raise InvalidInputError(f"{text!r}: N is a number from 1 to {worker.MOST_CHILDREN}")
    return int(number)
