"""`python -m myowarp` is the command `myowarp`."""

from myowarp.apps.cli.main import command

if __name__ == "__main__":
    command()
