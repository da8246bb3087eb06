"""``edmsim console servo``: a drive on its bench for a person, a script or a program; scope, tuning."""
