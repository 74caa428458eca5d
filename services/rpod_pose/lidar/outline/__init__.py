"""The outline of the target in a scan: which rays meet it, beside how far away it is.

The ranges of a flat face do not tell where on its plane the target lies. Which rays give a return does.
``places`` finds where near surfaces end between neighbouring rays, and ``steps`` gives what the results of
the rays beside such a place say of the pose.
"""
