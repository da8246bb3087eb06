"""``edmsim console servo``: a drive on its bench, operated by a person, a script or a program; scope, tuning."""
