"""What goes over HTTP: dataclasses of the domain as they are (`wire`), and a model where the two differ.

A comment in such a model says in what. `views` makes the models.
"""
