"""The outline of the target in a scan: evidence of which rays meet the target, in addition to its ranges.

The ranges on a flat face do not determine where in its plane the target is. This follows from which rays give
a return. ``places`` finds where near surfaces end between neighbouring rays. ``steps`` converts the results
of the rays beside such a place into evidence for the pose.
"""
