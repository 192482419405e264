"""A drive and the observer that it runs on as one sampled system, with wrong data if wanted."""
