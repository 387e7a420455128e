/* The least that a Cortex-M4 needs to begin: its stack, and where to start. */
extern void _start(void);
extern char __stack_top;

__attribute__((section(".vectors"), used)) static void *const vectors[] = {&__stack_top, (void *)_start};

void _init(void)
{
}

void _fini(void)
{
}
