"""How well alarms detect failures: ranks, rates at a realised rate of false alarms, delays, all from one alarm log."""
