"""Models of HTTP: unchanged dataclasses of the domain (`wire`), and models where the two differ.

A comment in such a model states the difference. `views` makes the models.
"""
