// SPDX-License-Identifier: MIT
// A memory of any depth, in the form that infers block RAM. What is read comes in the next cycle and stays.
//
// A block RAM is wide and shallow or narrow and deep. Tools take wide ones, and a memory deeper than these
// ends in a multiplexer of as many inputs as there are blocks on top of each other. So a deep memory is cut
// into parts of a power of two words, and a part into slices so narrow that one block has all of its words:
// what is left is a multiplexer of two inputs, or three.
//
// What is read of a word in the cycle in which it is written is undefined, and synthesis need not build what
// would define it. Only a host that reads results during a step asks for it, and its read is torn.
module pearl_memory
  import pearl_pkg::index_bits;
#(
    parameter int unsigned WIDTH = 32,
    parameter int unsigned DEPTH = 16,
    localparam int unsigned ADDR_BITS = index_bits(DEPTH)
) (
    input  logic                 clk_i,
    input  logic                 we_i,
    input  logic [ADDR_BITS-1:0] waddr_i,
    input  logic [    WIDTH-1:0] wdata_i,
    input  logic                 re_i,
    input  logic [ADDR_BITS-1:0] raddr_i,
    output logic [    WIDTH-1:0] rdata_o
);

  // A block of 36 Kbit at its full width; two of 18 Kbit are as good.
  localparam int unsigned BLOCK_WIDTH = 36;
  localparam int unsigned BLOCK_DEPTH = 1024;

  // A simulation's host moves whole memories at once, which it needs in one piece.
`ifdef PEARL_MEMORIES_IN_ONE_PIECE
  localparam bit DEEP = 1'b0;
`else
  localparam bit DEEP = DEPTH > BLOCK_DEPTH;
`endif

  // Words of the first part; the others are in the second.
  localparam int unsigned FIRST = 1 << (ADDR_BITS - 1);

  if (DEEP && DEPTH != 2 * FIRST) begin : gen_parts
    localparam int unsigned REST_BITS = index_bits(DEPTH - FIRST);
    logic in_rest, in_rest_q;
    logic [WIDTH-1:0] first, rest;

    assign in_rest = raddr_i[ADDR_BITS-1];
    always_ff @(posedge clk_i) if (re_i) in_rest_q <= in_rest;

    pearl_memory #(
        .WIDTH(WIDTH),
        .DEPTH(FIRST)
    ) u_first (
        .clk_i,
        .we_i   (we_i && !waddr_i[ADDR_BITS-1]),
        .waddr_i(waddr_i[ADDR_BITS-2:0]),
        .wdata_i,
        .re_i   (re_i && !in_rest),
        .raddr_i(raddr_i[ADDR_BITS-2:0]),
        .rdata_o(first)
    );
    pearl_memory #(
        .WIDTH(WIDTH),
        .DEPTH(DEPTH - FIRST)
    ) u_rest (
        .clk_i,
        .we_i   (we_i && waddr_i[ADDR_BITS-1]),
        .waddr_i(waddr_i[REST_BITS-1:0]),
        .wdata_i,
        .re_i   (re_i && in_rest),
        .raddr_i(raddr_i[REST_BITS-1:0]),
        .rdata_o(rest)
    );
    assign rdata_o = in_rest_q ? rest : first;
  end else begin : gen_slices
    localparam int unsigned FITTING = BLOCK_WIDTH * BLOCK_DEPTH / DEPTH;
    localparam int unsigned MOST = FITTING == 0 ? 1 : FITTING;
    localparam int unsigned SLICE = DEEP && MOST < WIDTH ? MOST : WIDTH;
    // An address has a bit even where there is one word only.
    localparam int unsigned WORDS = DEPTH > 1 ? DEPTH : 2;

    for (genvar low = 0; low < WIDTH; low += SLICE) begin : gen_slice
      localparam int unsigned BITS = low + SLICE > WIDTH ? WIDTH - low : SLICE;
      (* no_rw_check *)
      logic [BITS-1:0] mem[WORDS]  /* verilator public_flat_rw */;
      logic [BITS-1:0] rdata_q;

      always_ff @(posedge clk_i) begin
        if (we_i) mem[waddr_i] <= wdata_i[low+:BITS];
        if (re_i) rdata_q <= mem[raddr_i];
      end
      assign rdata_o[low+:BITS] = rdata_q;
    end
  end

endmodule
