"""``edmsim servo``: a drive on its bench, at a person's terminal, a pseudo-terminal or a pipe; scope and tuning."""
