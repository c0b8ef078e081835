"""The paper's printed numbers, and our runs beside them."""
