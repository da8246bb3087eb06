"""The controller of 1982: integer arithmetic, POSCAL, timers, and the planners built from them."""
