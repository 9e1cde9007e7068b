"""Run a command line: one line for an error, the version, and the progress of the work."""

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Annotated, Any

import typer

UsageError: Any = typer.BadParameter.__mro__[1]  # of click, or of the copy of click in typer
PROGRESS_INTERVAL_S = 30.0  # between two lines of progress if there is no terminal for a bar

# Set before numpy is loaded. Matrices are small here: BLAS's threads would wait for each other longer than they work,
# even more so beside other processes.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")


def command_line(name: str, about: str) -> typer.Typer:
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


def run(app: typer.Typer, name: str, wrong: tuple[type[Exception], ...], resumed: tuple[str, ...] = ()) -> None:
    """Run a command and end the process, with one line on stderr for an error.

    Exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted. `wrong` are the exceptions that are the user's
    to mend; their message is the line. `resumed` are the commands that keep what they have made when they are
    interrupted.
    """
    try:
        status = app(prog_name=name, standalone_mode=False)
        if status == 130:  # typer makes this of Ctrl-C
            raise KeyboardInterrupt
        sys.exit(status or 0)
    except UsageError as error:
        line = re.sub(r" \(Possible options: (.*)\)$", _name_alternatives, error.format_message())
        where = error.ctx.command_path if error.ctx else name
        print(line if "\n" in line else f"{where}: {line} (see {where} --help)", file=sys.stderr)
    except wrong as error:
        print(f"{name}: {error}", file=sys.stderr)
    except (KeyboardInterrupt, typer.Abort):
        kept = any(word in resumed for word in sys.argv[1:2])
        then = "the same command continues where it stopped" if kept else "nothing was written"
        print(f"{name}: interrupted; {then}", file=sys.stderr)
        sys.exit(130)
    except MemoryError:
        print(f"{name}: not enough memory", file=sys.stderr)
    except OSError as error:
        print(f"{name}: {error.filename or 'file'}: {error.strerror or error}", file=sys.stderr)
    sys.exit(2)


def _name_alternatives(options: re.Match[str]) -> str:
    """The options that a mistyped one may mean; --help only if there is no other."""
    names = options[1].split(", ")
    names = [n for n in names if n != "--help"] or names
    return f". Did you mean {' or '.join(names)}?"


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar with an estimate on a terminal, elsewhere a line on stderr now and then."""
    if not sys.stderr.isatty():
        yield print_progress(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def print_progress(what: str) -> Callable[[int, int], None]:
    """Return a function that prints the progress and the time left, at most once in PROGRESS_INTERVAL_S."""
    began = printed = time.monotonic()
    before: int | None = None  # done by an earlier run

    def progress(done: int, total: int) -> None:
        nonlocal printed, before
        before = done if before is None else before
        now = time.monotonic()
        if now - printed < PROGRESS_INTERVAL_S or done >= total:
            return
        printed = now
        left = f", about {(now - began) / (done - before) * (total - done):.0f} s left" if done > before else ""
        print(f"{what}: {done} of {total} after {now - began:.0f} s{left}", file=sys.stderr, flush=True)

    return progress
