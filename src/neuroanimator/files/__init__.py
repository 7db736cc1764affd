"""Files: input is bounded before it is parsed, and output is whole or absent.

Parsers take the bytes of a file and raise ValueError with one line on the fault; their callers, who know the file's
name, add it. They return only plain dictionaries, lists, numbers, texts and arrays.
"""
