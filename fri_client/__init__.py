"""The FRI client: messages and codec of KUKA's Fast Robot Interface, link statistics, the client's side of the loop.

Import the modules by their own names, so that a reader of recordings does not load the loop.
"""
