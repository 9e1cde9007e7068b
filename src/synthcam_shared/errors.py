"""The errors that a user may meet, and their message in one line: bad input, a faulty plugin, no OpenGL."""

from contextvars import ContextVar

# True if a command calls the library: errors then name its options, otherwise the arguments of the function.
CALLED_BY_COMMAND: ContextVar[bool] = ContextVar("called_by_command", default=False)


class InputError(ValueError):
    """Bad input: one line that names the file, the key or frame, and what was expected."""


class PluginError(InputError, TypeError):
    """A file of an effect, a free law or a detector that lacks what such a file must have."""


class NoGL(RuntimeError):
    """OpenGL cannot draw off-screen here. The message says in one line why, and what would help."""


def first_line(error: BaseException) -> str:
    """The first line of the message of an error, cut to 120 characters; its type where it has no message."""
    return " ".join(str(error).strip().partition("\n")[0].split())[:120] or type(error).__name__
