"""Files: what comes in is bounded before it is parsed, and what goes out is whole or absent.

Parsers take the bytes of a file and raise ValueError with one line saying what is wrong; their callers, who know
the file's name, say where. They make nothing but plain dictionaries, lists, numbers, texts and arrays.
"""
