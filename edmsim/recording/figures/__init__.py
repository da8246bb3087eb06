"""The figures of a cut: ``profile.png``, and the ones for a paper, one function each.

Each takes what a cut leaves, ``result.scene``, ``result.windows`` and ``result.report``, and returns a matplotlib
figure with an Agg canvas, for a paper one column wide; ``figure.savefig("name.pdf")`` writes it. No global state of
matplotlib is touched, and no display is needed.
"""
