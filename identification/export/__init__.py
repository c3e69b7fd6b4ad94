"""Robots and models written for other programs to read: URDF, SDF and MJCF, each checked by reading it back.

`write` exports a model, `kinematic_urdf` describes a built-in arm that has no description of its own.
"""
