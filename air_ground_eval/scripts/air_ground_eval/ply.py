"""The points of an augmented map (binary little-endian PLY with x y z red green blue source)."""
import numpy as np

TYPES = {'float': '<f4', 'float32': '<f4', 'double': '<f8', 'float64': '<f8', 'uchar': 'u1', 'uint8': 'u1', 'char': 'i1', 'int8': 'i1',
         'short': '<i2', 'int16': '<i2', 'ushort': '<u2', 'uint16': '<u2', 'int': '<i4', 'int32': '<i4', 'uint': '<u4', 'uint32': '<u4'}


def read_points(path):
    """Structured array of the vertices, one field a property. ValueError for another format."""
    with open(path, 'rb') as stream:
        if stream.readline().strip() != b'ply':
            raise ValueError(f'{path}: not a PLY file')
        fields, count, in_vertex = [], 0, False
        while True:
            line = stream.readline()
            if not line:
                raise ValueError(f'{path}: the header does not end')
            words = line.decode('ascii', 'replace').split()
            if words[:1] == ['format'] and words[1] != 'binary_little_endian':
                raise ValueError(f'{path}: only binary little-endian PLY is read')
            if words[:1] == ['element']:
                in_vertex = words[1] == 'vertex'
                count = int(words[2]) if in_vertex else count
            elif words[:1] == ['property'] and in_vertex:
                fields.append((words[2], TYPES[words[1]]))
            elif words[:1] == ['end_header']:
                break
        data = stream.read(count * np.dtype(fields).itemsize)
    if len(data) < count * np.dtype(fields).itemsize:
        raise ValueError(f'{path}: shorter than its header says')
    return np.frombuffer(data, np.dtype(fields), count)
