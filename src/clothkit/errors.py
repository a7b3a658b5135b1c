"""The one exception that a user is meant to read."""


class InputError(ValueError):
    """Bad input, told in one sentence that names the file, the field and what was expected."""
