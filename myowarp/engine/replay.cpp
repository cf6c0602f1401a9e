// Body of the native function `run` (replay.py, which says what the operations are). A row has four words.

typedef void (*Entry)(void*, void*);  // a kernel of Warp's on the CPU: bounds, arguments
typedef void (*Function)(uint64_t, uint64_t);
typedef int32_t (*Question)(uint64_t, uint64_t);
for (const uint64_t* op = &program.data[4 * row]; op[0] != FINISH;) {
    int64_t next = 1;
    switch (op[0]) {
    case LAUNCH:
        ((Entry)op[1])((void*)op[2], (void*)op[3]);
        break;
    case SET:
        memset((void*)op[1], (int)op[2], op[3]);
        break;
    case COPY:
        memcpy((void*)op[1], (const void*)op[2], op[3]);
        break;
    case CALL:
        ((Function)op[1])(op[2], op[3]);
        break;
    case TRY:
        for (int left = TRIES; left > 0 && next == 1; --left) {
            if (((Question)op[1])(op[2], 0))
                next = 2;
            else
                ((Function)op[3])(0, 0);
        }
        break;
    case JUMP:
        next = (int64_t)op[1];
        break;
    case JUMP_IF_ZERO:
        if (*(const volatile int32_t*)op[1] == 0) next = (int64_t)op[2];
        break;
    }
    op += 4 * next;
}
