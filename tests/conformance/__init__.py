"""The contract, tested on every installed backend."""
