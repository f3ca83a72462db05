"""An example of an ORBIT backend; docs/write-a-backend.md builds it step by step."""
