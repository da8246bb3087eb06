"""The physics: generator, gap, wire, dielectric, workpiece, table, and the pulse loop."""
