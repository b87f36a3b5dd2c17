"""Measurements of the methods: what is run, how it is judged."""
