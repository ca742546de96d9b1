"""What ends a command with one line instead of a traceback."""


class UserError(Exception):
    """The user asked for something that cannot be; the message says what would be right."""
