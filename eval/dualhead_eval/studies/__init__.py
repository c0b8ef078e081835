"""Studies: what is recorded, trained, evaluated and told, as plans."""
