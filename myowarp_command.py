"""The command `myowarp`, beside the package: Ctrl-C ends it quietly while the package is imported, too."""

import signal
import sys


def command() -> None:
    """Entry point of the command."""
    try:
        from myowarp.apps.cli.main import command
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    command()
