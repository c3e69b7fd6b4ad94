"""The log: message definitions, CDR packing, the MCAP writer and the recovery of broken-off files.

Nothing here knows processes, ZeroMQ or the ring; the recorder process calls the writer, the command line the recovery.
"""
