"""Code that engines written in Warp share: recorded launches, contact queries, optional arrays, common kernels.

Importing this package does not import Warp.
"""
