"""The converse of the monitor experiment: no surcharge of false alarms where the two ways are hardly apart."""
