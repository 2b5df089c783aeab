/* The complete state of an instance as bytes, the same on every machine. */

#ifndef CONGELATION_STATE_H
#define CONGELATION_STATE_H

#include <stddef.h>

size_t serialized_size(void);
void serialize(const double *state, unsigned char *bytes);
/* NULL, or what is wrong with the bytes. */
const char *deserialize(const unsigned char *bytes, size_t size, double *state);

#endif
