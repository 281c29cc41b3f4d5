"""What generate.py is made of: schema.py reads messages.toml, the others write one language each."""
