"""Comparing feed controllers: the same cuts on the same randomised machines, and the search of their gains."""
