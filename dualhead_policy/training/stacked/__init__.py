"""Many runs trained as one program: weights with a leading run axis, one step for all."""
