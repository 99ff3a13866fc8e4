/* A design of the live form, read from the file that Python wrote (transform/design/blob.py). */

#ifndef CUSHION_DESIGN_FILE_H
#define CUSHION_DESIGN_FILE_H

#include "../../transform/native/design_blob.h"

/* Read a file into a design; return NULL, or what is wrong with it: then nothing stays allocated. */
const char *design_read(Design *design, const char *path);

/* Read the design of a profile for a samplerate: the file that HAPTIC_CUSHION_DESIGN names, else
 * designs/PROFILE-RATE.design in the user's data folder or beside the plugin. Return whether it can
 * be used; else one line on stderr says why not. */
int design_find(Design *design, const char *profile, unsigned long samplerate);

void design_close(Design *design);

#endif
