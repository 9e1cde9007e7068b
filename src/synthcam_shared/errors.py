"""The one error for what a user gave and cannot be used."""


class InputError(ValueError):
    """Bad input: one line that names the file, the key or frame, and what was expected."""


class PluginError(InputError, TypeError):
    """A file of an effect, a free law or a detector that lacks what such a file must have."""
