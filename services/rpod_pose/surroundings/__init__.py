"""Frames that show more than the target: walls, a stand, the arm that holds it, things in front of it.

Parts of a frame that belong to other things are removed before the methods get it, so that they neither
attract the pose nor contradict it. A ray that passes through the place where the target should be remains a
contradiction.
"""
