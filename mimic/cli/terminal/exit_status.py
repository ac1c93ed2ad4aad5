"""Exit statuses of the ``mimic`` command."""

DONE = 0
"""Everything asked for is done."""
BUG = 1
"""A bug of mimic, shown with its traceback."""
USER_ERROR = 2
"""Something that the user has to fix: an option, a file, the environment."""
STOPPED = 3
"""Stopped by Ctrl-C, or by the robot for safety."""
PARTLY_FAILED = 4
"""A batch in which some files failed and the others were played."""
