"""What engines written in Warp share: recorded launches, contact queries, rows of environments, common kernels.

Importing this package does not import Warp.
"""
