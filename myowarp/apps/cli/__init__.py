"""The subcommands of `myowarp`, one a file: their options, and what they do with them."""
