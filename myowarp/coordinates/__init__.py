"""Another physics step: in the coordinates that follow no other, where a model asks for it."""
