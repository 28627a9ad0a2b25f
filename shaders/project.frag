void main()
{
  id = ps_id;
}
