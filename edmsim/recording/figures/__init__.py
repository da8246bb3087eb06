"""The figures of a cut: ``profile.png``, and the ones for a paper, one function each.

Each takes what a cut leaves and returns a matplotlib figure with an Agg canvas; ``figure.savefig("name.pdf")`` writes
it. No global state of matplotlib is touched, and no display is needed.
"""
