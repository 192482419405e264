#include <stdio.h>
int main(void)
{
    float in[3], out;
    while (fread(in, sizeof in, 1U, stdin) == 1U) {
        out = in[0] * in[1] + in[2]; /* two roundings, unless they are contracted into one */
        if (fwrite(&out, sizeof out, 1U, stdout) != 1U) { return 1; }
    }
    return 0;
}
