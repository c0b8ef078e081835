"""The evaluator's subcommands of ``dualhead``."""
