"""Gate files: the frozen evaluation product, validated on read, written atomically."""

from dualhead_eval.gate.gate import Gate, read_gate, write_gate

__all__ = ["Gate", "read_gate", "write_gate"]
