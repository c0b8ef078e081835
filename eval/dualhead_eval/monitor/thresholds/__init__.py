"""Thresholds that bound false alarms: split conformal, a band over time, one per group of decisions."""
