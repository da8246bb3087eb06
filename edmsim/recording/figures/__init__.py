"""The figures of a cut: ``profile.png``, and those for a paper, one function each.

The functions take ``result.scene``, ``result.windows`` or ``result.report`` and return a matplotlib figure with an
Agg canvas, one column wide if it is for a paper; ``figure.savefig("name.pdf")`` writes it. They do not change
matplotlib's global state, and need no display.
"""
