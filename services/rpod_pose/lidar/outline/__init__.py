"""The outline of the target in a scan: which rays meet the target, in addition to its ranges.

The ranges of a flat face do not tell where on its plane the target lies. Which rays give a return tells this.
``places`` finds where near surfaces end between neighbouring rays. ``steps`` turns the results of the rays
beside such a place into evidence for the pose.
"""
