"""A study shown: tables, plain data, and a page that tells each row under the pointer."""
