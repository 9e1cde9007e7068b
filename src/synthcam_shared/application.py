"""Run a command line: one line for an error, the version, and the progress of the work."""

import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Annotated, Any

import typer

from synthcam_shared.errors import CALLED_BY_COMMAND
from synthcam_shared.interruption import raise_if_interrupted, was_interrupted, watch_ctrl_c

UsageError: Any = typer.BadParameter.__mro__[1]  # of click, or of the copy of click in typer
PROGRESS_INTERVAL = (
    "SYNTHCAM_PROGRESS_S"  # the variable of the environment that sets the time between two lines of progress
)

# Set before numpy is loaded. Matrices are small here: BLAS's threads would wait for each other longer than they work,
# even more so beside other processes.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")


def make_command_line(name: str, about: str) -> typer.Typer:
    """Make an application that has no commands yet but prints its version."""
    app = typer.Typer(help=about, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)

    def print_version(wanted: bool) -> None:
        if wanted:
            print(f"{name} {version('synthcam')}")
            raise typer.Exit

    @app.callback()
    def options(
        show: Annotated[
            bool, typer.Option("--version", callback=print_version, is_eager=True, help="Show the version.")
        ] = False,
    ) -> None: ...

    return app


def run(
    app: typer.Typer,
    name: str,
    wrong: tuple[type[Exception], ...],
    resumed: tuple[str, ...] = (),
    lasting: tuple[str, ...] = (),
) -> None:
    """Run a command and end the process, with one line on stderr for an error.

    Exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted. `wrong` are the exceptions that are the user's
    to mend; their message is the line. `resumed` are the commands that keep what they have made when they are
    interrupted; `lasting` are those that start others.
    """
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # names of files that are not UTF-8
    with watch_ctrl_c(), _as_command():
        try:
            status = app(prog_name=name, standalone_mode=False)
            if status == 130:  # typer makes this of Ctrl-C
                raise KeyboardInterrupt
        except BaseException as error:
            if was_interrupted() or isinstance(error, KeyboardInterrupt | typer.Abort):
                command = "".join(sys.argv[1:2])
                then = "the same command continues where it stopped" if command in resumed else "nothing was written"
                then = "finished runs stay" if command in lasting else then
                print(f"{name}: interrupted; {then}", file=sys.stderr)
                raise SystemExit(130) from None
            if isinstance(error, SystemExit) and isinstance(error.__context__, BrokenPipeError):
                raise  # the reader of the output, such as head, has closed it; typer ends with 1
            line = _describe_error(error, name, wrong)
            if line is None:
                raise
            print(line, file=sys.stderr)
            raise SystemExit(2) from None
        raise SystemExit(status or 0)


@contextmanager
def _as_command() -> Iterator[None]:
    before = CALLED_BY_COMMAND.set(True)
    try:
        yield
    finally:
        CALLED_BY_COMMAND.reset(before)


def _describe_error(error: BaseException, name: str, wrong: tuple[type[Exception], ...]) -> str | None:
    """The line for an error that the user can mend; None for a fault of the program."""
    if isinstance(error, UsageError):
        line = re.sub(r" \(Possible options: (.*)\)$", _name_alternatives, error.format_message())
        where = error.ctx.command_path if error.ctx else name
        return line if "\n" in line else f"{where}: {line} (see {where} --help)"
    if isinstance(error, wrong):
        return f"{name}: {error}"
    if isinstance(error, MemoryError):
        return f"{name}: not enough memory"
    if isinstance(error, OSError):
        return f"{name}: {error.filename or 'file'}: {error.strerror or error}"
    if isinstance(error, UnicodeEncodeError):
        return f"{name}: {error.object[:200]!a}: not UTF-8, expected another name; rename the file or folder"
    if isinstance(error, RuntimeError) and f"{error}".startswith("Symlink loop"):  # an OSError from Python 3.13 on
        return f"{name}: {f'{error}'.partition(' from ')[2]}: a link that leads to itself, expected another path"
    if isinstance(error, SystemExit):  # of a file of the user, such as an effect
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{name}: {last.filename}, line {last.lineno}: ends the program; expected a file that does not"
    return None


def _name_alternatives(options: re.Match[str]) -> str:
    """The options that a mistyped one may mean; --help only if there is no other."""
    names = options[1].split(", ")
    names = [n for n in names if n != "--help"] or names
    return f". Did you mean {' or '.join(names)}?"


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show the progress as a bar with an estimate on a terminal, elsewhere as lines. A total of 0: without end."""
    if not sys.stderr.isatty():
        yield print_progress(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task(what, total=None)

    def show(done: int, total: int) -> None:
        raise_if_interrupted()
        bar.start()  # not before, because it starts a thread
        bar.update(task, completed=done, total=total or None)

    try:
        yield show
    finally:
        bar.stop()


def read_progress_interval(usual: float = 30.0) -> float:
    """The time between two lines of progress if there is no terminal, s, by PROGRESS_INTERVAL of the environment."""
    asked = os.environ.get(PROGRESS_INTERVAL, "")
    return float(asked) if re.fullmatch(r"\d+(\.\d+)?", asked) else usual


def print_progress(what: str) -> Callable[[int, int], None]:
    """Return a function that prints the progress and the time left, at most once in `read_progress_interval`."""
    began, interval = time.monotonic(), read_progress_interval()
    printed = began
    first: tuple[int, float] | None = None  # done by an earlier run, or after a survey that comes first; and when
    latest = 0

    def progress(done: int, total: int) -> None:
        nonlocal printed, first, latest
        raise_if_interrupted()
        now = time.monotonic()
        first = (done, now) if first is None or done < latest else first  # a second pass starts the count again
        latest = done
        before, since = first
        if now - printed < interval or 0 < total <= done:
            return
        printed = now
        seconds = (now - since) / (done - before) * (total - done) if done > before else 0.0
        left = f", about {seconds:.0f} s left" if seconds > 0 else ""
        of = f" of {total}" if total else ""
        print(f"{what}: {done}{of} after {now - began:.0f} s{left}", file=sys.stderr, flush=True)

    return progress
