"""The search for effects: what each hypothesis would gain, at what price, and which of them the data show."""
