// A memory of which one word is known, any one, and every other read gives anything. What is proved of a
// design with it holds with the whole memory: so a proof carries one word of each, not all of them.
module pearl_ram
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

  // The word's address, free in the first cycle and the same ever after.
  logic [ADDR_BITS-1:0] any_addr, addr_q, tracked;
  logic kept_q = 1'b0;
  assign tracked = kept_q ? addr_q : any_addr;

  logic [WIDTH-1:0] any_word, content_q, rdata_q;

  always_ff @(posedge clk_i) begin
    kept_q <= 1'b1;
    addr_q <= tracked;
    if (we_i && waddr_i == tracked) content_q <= wdata_i;
    if (re_i) rdata_q <= raddr_i == tracked ? content_q : any_word;
  end

  assign rdata_o = rdata_q;

  always_ff @(posedge clk_i) begin
    if (we_i) assert (32'(waddr_i) < DEPTH);
    if (re_i) assert (32'(raddr_i) < DEPTH);
  end

endmodule
