"""Gate files: the frozen evaluation product, validated on read, written atomically."""

from dualhead_eval.gate.file import read_gate, write_gate
from dualhead_eval.gate.gate import Gate

__all__ = ["Gate", "read_gate", "write_gate"]
