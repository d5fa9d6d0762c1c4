// SPDX-License-Identifier: Apache-2.0
// Linked into the tests labelled `threads` of a ThreadSanitizer build: what is not ours to mend.
extern "C" const char* __tsan_default_suppressions();

// OpenCV's image codecs start GDAL up, which takes two mutexes of its own in both orders (once, in
// one thread).
extern "C" const char* __tsan_default_suppressions() { return "deadlock:libgdal.so\n"; }
